"""Who may do what on the bus: addresses, certificates of a site, rights of roles, and proofs of origin."""
