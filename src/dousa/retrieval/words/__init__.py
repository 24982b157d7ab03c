"""Words for motions: a table of movement words in two languages, what bodies do in words, and how both are matched."""
