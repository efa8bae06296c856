"""The commands of usbldr, one file each. No mathematics; heavy imports sit inside the function that needs them."""
