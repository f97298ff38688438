"""From an analysis to report.html and appendix.html (`experiments/report.py` writes them).

tables    frames of text, and numbers of outcomes as people read them
figures   each a pure function that returns SVG
showcase  films of two agents in the same scenario, for templates/player.js
page      what the templates show; their sentences stand in experiments/templates
"""
