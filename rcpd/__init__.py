"""The command line of the gateway: `rcpd`, its demo, plugin scaffolds, and store maintenance."""
