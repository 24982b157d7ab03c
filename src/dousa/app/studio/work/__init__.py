"""The work of jobs, each kind a function of its request; see `dousa.app.studio.work.worker`."""
