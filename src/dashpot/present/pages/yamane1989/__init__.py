"""The reproduction of Yamane (1989), for eyes."""
