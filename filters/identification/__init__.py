"""What a log itself tells of its sensors' errors and noise, without any truth."""
