"""What labellers and forests learn from beside what a library holds: takes made of clips, and motions disturbed."""
