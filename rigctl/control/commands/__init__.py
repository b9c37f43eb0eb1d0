"""Commands from the ring: what their answers depend on, and what they do.

It is entered by `orders.Orders`; the gateway reads `situation.Situation`.
"""
