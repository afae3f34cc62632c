"""Reports of a diagnosis: sentences, tables, figures and an HTML file."""
