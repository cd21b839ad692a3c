"""The plant of the virtual arm: physics written apart from the effects that are fitted."""
