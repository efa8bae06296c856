"""What is wrong with a log for navigation, and the configuration that its data suggest."""
