"""Public interface: `from micah_plan import learn, explore, solve, execute, predict, calibrate, load, save, show`."""
