"""Studies of the law, the paper, the cell and the drive: judges and comparisons that no other part needs."""
