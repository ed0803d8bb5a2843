"""Programs that print the project's figures: ``python -m tests.evidence NAME``; each writes results/NAME.json.

A program is one module of this folder with

- ``TITLE`` and a docstring; what the page asks and shows of them stands in ``page.SHOWN``;
- ``options(parser)`` (optional): arguments of its own, with the defaults that made the figures that are kept;
- ``cases(asked)``: name -> case, all that ``one`` needs, writable as JSON;
- ``one(case)``: the results of a case as a dict, computed in a process of its own, by seed the same anywhere;
- ``summary(results, asked)``: their ``Evidence``. ``results`` are those of the cases that did not fail.

``ALONE = True`` says that cases are measured one after the other in this process (times, devices on ports).
"""
