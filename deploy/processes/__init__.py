"""The processes of a run: started, linked, struck, recorded."""
