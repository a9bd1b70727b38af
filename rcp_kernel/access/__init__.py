"""Authentication and authorization: credentials, access rules and their conditions."""
