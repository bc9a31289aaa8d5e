"""Real and simulated hardware: a serial board that drives two heated actuators and reads their sensors.

`scpjax.bench.rig.Rig` is where to start; `scpjax rig --help` does the same from the command line. Real ports need
pyserial: ``pip install pyserial``; the emulated board needs nothing.
"""
