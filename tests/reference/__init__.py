"""Plain NumPy forms of what the compiled engine computes: the tests compare the two.

Written for reading, not for speed, and with constants of their own: a changed constant is a
difference that a test shows.
"""
