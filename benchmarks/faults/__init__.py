"""``make faults``: what an exported controller does where sensors, drives, mechanics or the clock of an arm fail.

`robot` and `links` read a robot from the text of its file, `plant.c` is that arm, `runner.c` calls the exported
controller as its main.c does, `faults.c` does what is asked to signals and plant, `decide.h` is the rule that decides
whether the output may act. `kinds` names the faults, `arms` makes designs, exports and programs, `runs` draws and runs
them, `verdict` judges, `tables` shows.
"""
