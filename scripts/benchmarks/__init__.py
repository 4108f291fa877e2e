"""Long runs, and comparisons that no user of the product needs: run by hand."""
