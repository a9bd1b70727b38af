"""The command line of the gateway: `rcpd`, its demo, its skeletons of plugins and the care of its store."""
