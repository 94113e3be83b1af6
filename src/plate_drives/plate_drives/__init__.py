"""Drives of CiA 402 on a CAN bus without a board in between: they are commissioned from here.

`commission` is the command; it needs python-can.
"""
