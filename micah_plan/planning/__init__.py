"""Planning under uncertainty with a hybrid automaton, by POMDP-HD.

In the order in which a plan is made: `attempt` (the frame of every planner), `pomdp_hd` (the algorithm), `search` (the
high level: mode sequences), `transcription` and `nlp` (the low level: a belief trajectory through each), `feedback`
around it, `roll_outs` and `verification` of it, `tightening` where it fails too often, `findings` on failures,
`replanning` during execution. All of them use `limits` and `path_constraints`.
"""
