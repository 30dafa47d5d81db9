"""A differential-drive robot on the paper's factory floor: `make robot`, or `python -m examples.robot --help`.

    floor.py       cells, walls and oil, in metres
    kinematic.py   a plant in numpy: wheels that roll and slip, walls that stop; thousands of robots side by side
    physics.py     the same in MuJoCo (`pip install 'stltool[robot]'`)
    controller.py  the nine moves, driven by a noisy low-level controller on either plant
    fleet.py       robots as a black box for stltool: reset(n), step(actions)
    walk.py        random walks, and what tables made of them predict
    story.py       learn, promise, compare; __main__.py runs it and writes a page

Nobody wrote down the probabilities of the moves: they are what the controller makes of noise, clock, walls and oil.
"""
