"""Generated functions: `read` makes a list of operators of a model's reply, `run` executes such a list, and nothing else.

A reply is text until `read` has traced it: once, as Python, in a confined process. What is stored, trained with, evaluated
and handed on is the list (`porse.functions.run.program`), which is data and needs no trust.
"""
