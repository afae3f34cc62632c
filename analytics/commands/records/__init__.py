"""Commands of certificates, proposals and the audit."""
