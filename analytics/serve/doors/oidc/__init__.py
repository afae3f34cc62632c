"""Login by a provider of OpenID Connect."""
