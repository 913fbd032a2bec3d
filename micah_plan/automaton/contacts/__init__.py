"""Contact modes of a held object: the product of a learned automaton with contacts to its surroundings."""
