"""What asks the running nodes. It imports nothing by itself: a stop must not wait for the rest."""
