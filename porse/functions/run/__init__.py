"""From an operator list to a function that training calls: the list, its operators, their shapes, portable forms, execution."""
