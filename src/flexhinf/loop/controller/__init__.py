"""A sampled controller: `controller` compiles it and keeps its memory, `step` is the code of one sample."""
