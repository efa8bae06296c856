"""Reports as one HTML file each, with interactive figures: replay, evaluate, compare, check and drill share it."""
