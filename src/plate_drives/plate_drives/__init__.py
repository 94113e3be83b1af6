"""Drives on a CAN bus that are commanded by this computer, without a board.

`commission` checks CiA 402 drives on the bus and adapts the rig file to them. It needs python-can.
`socketcan` is the transport to the drives, and `lateness` measures the delay of its setpoints.
"""
