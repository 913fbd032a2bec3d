"""`python -m micah_plan` is `micah-plan`."""

from micah_plan.cli import main

if __name__ == "__main__":
    main()
