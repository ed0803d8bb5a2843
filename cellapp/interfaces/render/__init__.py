"""Tables and charts as terminal text, screen and HTML."""
