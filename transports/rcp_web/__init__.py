"""Parts of the application of a `Mount`: ASGI helpers, and Litestar controllers.

`asgi` has what every `Mount` needs, with and without Litestar. `Application` serves controllers,
with errors as envelopes, `calls` describes them, and `read_query` parses the query of any request
strictly.
"""
