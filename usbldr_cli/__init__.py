"""The commands of usbldr, one file each. No mathematics; heavy imports are inside the functions that need them."""
