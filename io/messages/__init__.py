"""Message types: which fields hold which quantity of which sensor, and which topic serves as which sensor."""
