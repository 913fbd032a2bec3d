"""Planning under uncertainty with a hybrid automaton, by POMDP-HD.

In the order in which a plan comes about: `attempt` (what every planner begins and ends with), `pomdp_hd` (the
algorithm), `search` (the high level: mode sequences), `transcription` and `nlp` (the low level: a belief trajectory
through each), `feedback` around it, `roll_outs` and `verification` of it, `tightening` where it fails too often,
`findings` where there is none, `replanning` while it is being followed. All of them use `limits` and
`path_constraints`.
"""
