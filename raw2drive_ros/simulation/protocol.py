"""Under which rules drives are judged.

pairs: the suite's own limits of time; every route is an event and its twin. bench2drive: the loose limits of the public
benchmark and single drives, for comparison with it.
"""

PAIRS, BENCH2DRIVE = 'pairs', 'bench2drive'
PROTOCOLS = (PAIRS, BENCH2DRIVE)
