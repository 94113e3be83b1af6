"""Functions that call the running nodes. This file imports no module, so that it does not delay a
stop."""
