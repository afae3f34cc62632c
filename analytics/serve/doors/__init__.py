"""Who may enter: token, users with roles, sessions, protection against other sites."""
