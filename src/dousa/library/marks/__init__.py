"""What people note about clips for themselves: tags, favourites, searches and selections that they keep."""
