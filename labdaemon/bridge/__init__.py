"""Events onto other buses: MQTT, and bluesky's documents. Each bridge is a program of its own, and a client."""
