"""Designs, exports and help of an earlier commit beside those of the present tree, number by number.

`tree` reads what one tree gives, through its command line, `Design`, the folder of a report and exported C alone; so it
reads both trees, however their insides differ. `compare` says what differs, `reasons` why a number may.
"""
