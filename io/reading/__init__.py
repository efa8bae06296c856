"""From a path to a Log: open, choose topics, convert; from a Log to epochs; from a topic or file to a track."""
