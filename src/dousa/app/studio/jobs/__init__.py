"""Work that outlives a request: the board, its lanes, and the processes and threads that do it."""
