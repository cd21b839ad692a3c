"""The plant of the virtual arm: physics written apart from everything that is fitted.

It shares no code with `excitant.robots.effects`, so finding what it hides proves something.
"""
