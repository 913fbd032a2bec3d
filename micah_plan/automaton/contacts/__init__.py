"""Contact modes of a held object: the product of a learned automaton with its contacts to the surroundings."""
