"""Calibration certificates: their content by the clauses of a standard, PDF, digital certificate, signature, record."""
