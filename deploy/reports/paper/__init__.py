"""Results for papers: figures as PDF or SVG, tables as LaTeX, and a citation."""
