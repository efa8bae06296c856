"""Message types: which field holds which quantity of which sensor; roles.py chooses a topic for each sensor."""
