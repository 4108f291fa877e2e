"""Data sheets: how much delay an arm takes, on one page."""
