"""The rows of the fault catalogue, by what fails.

It is entered by `named_rows`.
"""
