"""Several objects: their model beside Drake's and MuJoCo's, learning, and tasks."""
