"""Work that outlives a request: the board, its lanes, the processes and threads that do it."""
