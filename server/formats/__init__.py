"""Reading and writing what boxes and files hold: every format becomes `Columns`, checked once."""
