"""Drives on a CAN bus without a board in between.

`commission` looks at drives of CiA 402 and fits the rig file to them (it needs python-can);
`socketcan` is the transport by which this computer leads drives, and `lateness` tells how well.
"""
