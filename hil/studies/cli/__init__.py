"""The commands of ``python -m hil`` that play a study: their options and what they print."""
