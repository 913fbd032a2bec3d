"""The hybrid filter for many roll-outs at once: the same arithmetic as the scalar one, over arrays of beliefs."""
