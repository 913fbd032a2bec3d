"""Files that people write and read, YAML and JSON, to values and back, with the place of every mistake.

One file per noun. What is called `JointDocument` is the layout of its entry, `joint_of` reads an entry and `joint_data`
writes it; each undoes the other. A reader is given the place of its entry (`Located`) and raises an InputError that
names line, column and key; a writer raises one for a value that no file can hold.
"""
