"""Files that people write and read, YAML and JSON, to values and back, with the place of every mistake.

One file per noun: `JointDocument` is the layout of the entry of a joint, from which reading, writing and the schema
follow. A reader is given the place of its entry (`Located`) and raises an InputError that names line, column and key; a
writer raises one for a value that no file can hold.
"""
