"""What the workbench and the command line compute of a recording, as JSON documents.

Not for the API process: it loads the numerics.
"""
