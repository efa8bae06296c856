"""Tables on the terminal, in Markdown and in CSV."""
