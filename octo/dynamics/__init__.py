"""Floor 2: FD and its Jacobians (§4)."""
