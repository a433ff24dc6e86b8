"""What happened on a drive: crashes and harsh driving, road shocks, and the handling of the box.

``record`` holds what is said of an event, ``trigger`` finds the moments worth looking at, ``classify`` says what they
were, ``driving`` finds harsh manoeuvres; `nav_core.crash` works the numbers out.
"""
