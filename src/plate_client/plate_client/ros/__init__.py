"""Calls of the running nodes. This file imports nothing, so that it does not delay a stop."""
