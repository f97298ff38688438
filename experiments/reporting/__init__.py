"""From an analysis to report.html and appendix.html (`experiments/report.py` writes them)."""
