"""Where one joint takes over from another: noise, evidence, changepoints and how sure they are."""
