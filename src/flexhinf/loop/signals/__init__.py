"""Commands, disturbances and noise as functions of time, and as samples of a run."""
