"""What became of a run that an observer recorded: `film` decodes it, `judge` holds it against the
limits and the task, `pictures` draws it; `bag` keeps all messages for other programs.
"""
