"""What became of a run that an observer recorded: `film` decodes it, `judge` holds it against the
task and, by the mechanics of `limits`, against the rig; `pictures` draws it; `bag` keeps all
messages for other programs.
"""
