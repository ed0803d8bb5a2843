"""The handbook: chapters as Markdown, figures as SVG, and the code that draws the figures from the models."""
