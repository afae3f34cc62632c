"""The closed loop: blocks, error models, the trace of what a model lacks, and models in use."""
