"""What jobs do. A function gets what was asked for as plain values that were checked when they came in, and a context;
it returns plain values. It calls ``context.progress`` often: that is where work in a thread is stopped. Larger results
go into files of ``context.folder``.
"""
