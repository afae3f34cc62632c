"""The pages: one file a page, with a template of the same name."""
