"""Reading what a store has of a run: channels of the model, and signals as they were recorded."""
