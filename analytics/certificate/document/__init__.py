"""The files of a certificate: PDF with curves, digital certificate, signature."""
