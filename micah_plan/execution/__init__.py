"""Plants (nominal, MuJoCo), closed-loop execution of plans, and statistics over trials."""
