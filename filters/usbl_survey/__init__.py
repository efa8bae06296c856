"""Surveys of a transponder that lies still, from a ship: how its USBL is installed, and how good its fixes are."""
