"""A simulated GigE Vision camera that looks at a room."""
