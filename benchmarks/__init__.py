"""Long studies: accuracy, cost and behaviour over months."""
