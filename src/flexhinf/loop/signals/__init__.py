"""Commands and disturbances as functions of time."""
