"""Everything small that processes tell each other: zenoh session, key names, typed messages, worker life cycle."""
