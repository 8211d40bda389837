"""What the solver and the campaigns share: checks of input, pytrees, text, tables, files and packages of extras."""
