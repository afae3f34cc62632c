"""Attestations: signed anchors of a store's history, so that nothing before them can change unseen."""
