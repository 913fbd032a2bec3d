"""Plants (the model, MuJoCo, your own machine), closed-loop execution of plans, and statistics over trials."""
