"""The texts that a person or a program reads, each with a name: two commits are compared by them."""
