"""The windows of many takes in files of their own, from which a search reads only windows that may be answers."""
