"""From an analysis to report.html (`experiments/report.py` writes it).

style              the palette and number formats, for everything that draws
report_view        rows and words of the template
report_figures     which figures, in which order
figures            each a pure function that returns SVG
collision_figures  the paper's figure 3
beside             result directories side by side
card               what the paper says and what was done here
showcase           films of two agents in the same scenario, for templates/player.js
"""
