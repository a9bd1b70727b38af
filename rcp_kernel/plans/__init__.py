"""Plans: many operations as one command, checked whole before the first, run with the asker's rights."""
