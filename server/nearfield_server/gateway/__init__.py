"""The web side of the service: page, REST, websocket, metrics on one port. The only importer of FastAPI."""
