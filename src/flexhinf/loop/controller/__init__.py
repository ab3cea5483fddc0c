"""A sampled controller: `controller` compiles and remembers, `step` is what one sample computes."""
