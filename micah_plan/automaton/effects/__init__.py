"""What a model may lack: effects as values, their forms (each written once), and how an automaton takes them in."""
