"""A Timeline through a filter: the start, one step per epoch, late fixes, and what the whole run gives.

Only this room knows the grid, times of validity and times of arrival; a filter sees Steps. methods.py is the catalogue
of everything that makes a track, and what each can do.
"""
