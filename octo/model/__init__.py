"""Floor 1: what moves and what it touches (§3)."""
