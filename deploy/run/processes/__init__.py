"""The processes of a run: started, linked, made to fail, recorded."""
