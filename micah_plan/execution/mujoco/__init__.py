"""Objects in MuJoCo: a common core, and plants for standing (`standing`) and held objects (`held`).

Words. A *standing* object is pulled by its handles; a *held* one is in the hand, by one of its two parts. The *grip* is
where the hand has it, the *grasp* where the tool of an arm has the hand. A *carrier* moves the hand: three slides, or
that arm. A *latch* locks a joint at one configuration.
"""
