"""Evaluation of a run that an observer has recorded.

`film` decodes the messages. `judge` checks the result against the task and, with the mechanics of
`limits`, against the rig. `pictures` draws the run. `bag` records all messages for other programs.
"""
