"""From connected cameras to a room file: what is there, what it sees, and the tables that name it."""
