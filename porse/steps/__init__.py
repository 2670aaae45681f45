"""What the stages do: one module and one function a stage, which reads folders, calls what the paper says, and writes a folder.

A step knows paths and tables, and nothing of DVC or the command line. `stages/` calls one step a process; `porse.iteration`
calls all of them in one.
"""
