"""What the devices send and are sent, and the corrections of a force.

It is entered by `inbox.Inbox`, `outbox.Outbox` and `readback.Readback`.
"""
